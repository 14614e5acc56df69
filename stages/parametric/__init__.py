"""The rival without interaction and without a Gaussian process: a muscle law that is linear in its coefficients.

Arrays of pressure, contraction and force flow in; a `LinearMuscleModel` flows out, which predicts forces.
"""
