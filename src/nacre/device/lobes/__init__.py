"""The lobes' Mitsuba plugins, one file each."""
