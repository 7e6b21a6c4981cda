"""The formats of other programs and of makers, one file each, and what they make of a lobe."""
