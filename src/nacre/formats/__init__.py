"""Exchange and fabrication file formats, and conversions between them and lobes."""
