"""Where a simulation and what was measured disagree, which named effect is missing, and what it takes away.

A `Cell` is one channel of one element of a machine. `prepare` fits its nominal constants and its noise; `search` names
effects and adds them; `locate` tells in which regimes the gap lies.
"""
