"""An emulated Festo CPX-E with a machine and a person behind it, as a process of its own."""
