"""The lobes' twins on the device, one file each."""
