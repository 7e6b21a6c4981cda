"""Studies of a material: report, fit, tolerance, sweep."""
