"""Pages for the participant and the operator of a trial, and the server that shows them."""
