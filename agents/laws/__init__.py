"""The paper's control laws: pure functions and little state."""
