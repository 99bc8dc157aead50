"""Where a vehicle believes it is: instruments, fixes and the filter; and the grades that ship, as data."""
