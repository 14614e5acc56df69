"""Where simulation and measurement disagree: find it, name what is missing, add it, verify that the gap shrinks."""
