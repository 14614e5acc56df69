"""How often the discrepancy workflow is right, on sessions whose truth it does not see."""
