"""The lobes, one file each."""
