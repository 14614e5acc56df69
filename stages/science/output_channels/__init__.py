"""What is fitted: the output channels of a machine, with their constants, their noise and a flexible model."""
