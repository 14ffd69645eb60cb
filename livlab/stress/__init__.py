"""Hard cases: a catalogue of them with trusted values, and what becomes of it on this machine."""
