"""Multi-sphere ensembles: the reference solution that corrects the mean-field model."""
