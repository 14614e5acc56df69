"""Three stages that count, double in a loop, and add up: enough to try everything that the pipeline promises."""
