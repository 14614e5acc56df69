"""How often the discrepancy workflow is right: rigs whose truth is sealed."""
