"""Lobes on the device: one `LobePlugin` per lobe kind, one Mitsuba BSDF around them."""
