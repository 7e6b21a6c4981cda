"""The Mitsuba plugins of the lobes, one file each."""
