# python-osc: a threading server with a dispatcher, messages and bundles in both directions.
import sys, threading, time
from pythonosc import dispatcher, osc_bundle_builder, osc_message_builder, osc_server, udp_client
me = int(sys.argv[1]); t0 = time.monotonic(); d = dispatcher.Dispatcher()
d.map("/depth", lambda address, *values: print(f"{time.monotonic() - t0:.1f}", address, values))
server = osc_server.ThreadingOSCUDPServer(("0.0.0.0", 9001), d); threading.Thread(target=server.serve_forever).start()
client = udp_client.SimpleUDPClient(f"10.0.0.{3 - me}", 9001); time.sleep(0.95)
for k in range(3): client.send_message("/depth", [me, k, 0.5, "m"]); time.sleep(1)
bundle = osc_bundle_builder.OscBundleBuilder(osc_bundle_builder.IMMEDIATELY)
message = osc_message_builder.OscMessageBuilder("/depth"); message.add_arg(f"bundle of {me}"); bundle.add_content(message.build())
client.send(bundle.build()); time.sleep(1); server.shutdown(); print("done")
