"""A recorded run once more: verified, continued, or with another agent."""
