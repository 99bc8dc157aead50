"""How fast the emulator is: `python -m benchmarks`. The other files here are scripts of their own."""
