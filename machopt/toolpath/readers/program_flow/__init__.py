"""Variables, jumps and subprograms, shared by G-code and Siemens readers."""
