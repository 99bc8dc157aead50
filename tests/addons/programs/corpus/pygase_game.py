# pygase: the state of a game over UDP; agent 1 is the backend, agent 2 a client with an event.
import sys, threading, time
from pygase import Backend, Client, GameState
me = int(sys.argv[1])
if me == 1:
    def move(game_state, dx, **_): return {"x": game_state.x + dx}
    backend = Backend(GameState(x=0, steps=0), lambda s, dt: {"steps": s.steps + 1, "x": s.x}, event_handlers={"MOVE": move})
    threading.Timer(6, backend.shutdown).start(); backend.run("0.0.0.0", 8080); print("stopped")
else:
    client = Client(); time.sleep(1); client.connect_in_thread(hostname="10.0.0.1", port=8080); time.sleep(1)
    client.dispatch_event("MOVE", dx=5, ack_callback=lambda: print("moved")); time.sleep(1.5)
    with client.access_game_state() as s: print("x", s.x, "steps many", s.steps > 20)
    client.disconnect(); time.sleep(0.5); print("done")
