"""What people do with a material once they can see it: report, fit, tolerance, sweep."""
