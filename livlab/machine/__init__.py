"""What this machine is and has: libLLVM, GPU, versions, processor."""
