"""Where a simulation and what was measured disagree, which named effect is missing, and what it takes away.

`prepare` fits the nominal constants and the noise of each output channel; `search` names effects and adds them;
`locate` reports in which regimes the gap lies.
"""
