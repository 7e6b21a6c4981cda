"""The terms of which a Bsdf is the sum, one file each."""
