"""File formats of other programs and of fabrication, one module each, and conversions of lobes to them."""
