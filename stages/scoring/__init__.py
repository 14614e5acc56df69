"""What a search said of sessions against what was hidden in them.

Frames of truth and of what was said flow in; judged sessions, and shares with intervals, flow out.
"""

from stages.scoring.intervals import bound_median, bound_rate
from stages.scoring.sessions import Rules, score

__all__ = ["Rules", "bound_median", "bound_rate", "score"]
