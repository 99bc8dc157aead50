"""The paper's control laws: pure functions, and classes with little state."""
