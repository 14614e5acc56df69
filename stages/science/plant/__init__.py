"""The simulated machine and the person in it.

Configuration says which muscles move which joints (`exoskeleton`), with which constants and named effects (`plant`),
and how a person moves (`participant`). Commands and intentions flow in; pressures, forces and joint motion come out.
"""
