"""Kinds of machines whose records are simulated: a file each, with one subclass of `RecordPlant` named PLANT."""
