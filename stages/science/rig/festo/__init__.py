"""The real rig: muscles on a Festo CPX-E, sampled over Modbus at a fixed rate."""
