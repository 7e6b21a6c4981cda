"""Relief: height maps, diffraction under finite coherence."""
