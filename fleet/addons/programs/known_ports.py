"""Ports that have a meaning on every agent."""

ZENOH_PORT = 7447  # zenoh's own; where nobody of the program listens, the agent has an endpoint
WATER_PORT, READY_PORT = 7448, 7449  # where endpoints hear each other, and where one says that it listens
NAVIGATION_PORT, COMMAND_PORT = 14560, 14561  # of the vehicle, see `steering`
MODEM_PORT, MODEM_AGENT_PORT = 7450, 7451  # where the modem beside a program and its agent hear each other
