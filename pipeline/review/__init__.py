"""Looks at what runs have left: lists, comparisons, sweeps, as text and as pages; and removes what is not needed now.

The folder of outputs flows in; text and pages flow out. Nothing here runs a stage; no run is changed but by `prune`.
"""
