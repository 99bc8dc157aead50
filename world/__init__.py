"""The sea: vehicle dynamics, disturbances, sensors, actuators, and who is alive."""
