"""Two materials side by side on one surface, by a mask: prints, inlays, worn coatings."""
