"""Reading logs, whole, cut or damaged, as messages, arrays or tables."""
