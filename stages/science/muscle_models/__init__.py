"""Models of all muscles together: what is known of each, and which samples its model stands on.

Frames in the columns of the tables flow in; standardised arrays and frames of samples flow out. The science of one
Gaussian process is in `gp`; here it meets names, units and muscles.
"""
