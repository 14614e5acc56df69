"""What a search said of sessions against what was hidden in them.

Frames of truth and of what was said flow in; judged sessions, and shares with intervals, flow out.
"""
