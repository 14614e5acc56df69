"""Tests of what is kept of compiled functions."""
