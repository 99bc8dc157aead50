"""Child processes: started cheaply, noticed when they end, never left behind."""
