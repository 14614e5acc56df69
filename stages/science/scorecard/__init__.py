"""How often the discrepancy workflow is right on rigs whose missing effect is known."""
