"""Recordings that others made: their columns, units, clocks and gaps.

Frames as they were read flow in, with what is known of the machine; tidy frames in this project's names and units flow
out, or a `RecordingError` that names column and rows. No path is known here.
"""
