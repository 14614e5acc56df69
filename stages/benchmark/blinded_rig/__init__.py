"""A rig that hides an effect: an independent simulator of measured datasets.

Flows in: a scenario (which effect, how large, on which muscles, which seed). Flows out: a folder in the format of a
measured dataset, and beside it a sealed file with the truth. It shares no code with ``stages``: the physics is written
in other mathematical forms and integrated at a finer step, so that a workflow that finds the effect has not merely
recognised its own code.
"""
