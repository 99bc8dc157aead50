"""Programs of others as agents in lockstep: unchanged, on stand-ins for time, threads, sockets, zenoh and asyncio."""
