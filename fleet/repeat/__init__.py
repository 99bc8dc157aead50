"""A recorded run once more: verified, continued, with another agent, or judged by other checks."""
