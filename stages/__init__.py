"""The study, in the order data flows: a file is a stage, a folder is science."""
