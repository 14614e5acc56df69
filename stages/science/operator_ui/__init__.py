"""Pages and terminal on which an operator decides on each trial, and the participant sees it."""
