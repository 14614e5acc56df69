"""Figures: frames flow in, matplotlib figures flow out."""
