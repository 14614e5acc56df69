"""What needs no pipeline: arrays and frames in, arrays and frames out. It knows no paths."""
