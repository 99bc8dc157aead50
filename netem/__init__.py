"""The network: messages, keys, zenoh sessions, link impairments and the message ledger."""
