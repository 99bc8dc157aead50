# amqtt is the broker in agent 1, paho-mqtt the client in agents 2 and 3.
import asyncio, sys, time
me = int(sys.argv[1]); t0 = time.monotonic()
if me == 1:
    from amqtt.broker import Broker
    async def main():
        broker = Broker({"listeners": {"default": {"type": "tcp", "bind": "10.0.0.1:1883"}}, "plugins": {"amqtt.plugins.authentication.AnonymousAuthPlugin": {"allow_anonymous": True}}})
        await broker.start(); await asyncio.sleep(7); await broker.shutdown(); print("stopped")
    asyncio.run(main())
else:
    import paho.mqtt.client as mqtt
    c = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id=f"agent{me}")
    c.on_connect = lambda c, u, flags, reason, properties: (print("connected", reason), c.subscribe("chat/#", 1))
    c.on_message = lambda c, u, m: print(m.topic, m.payload.decode(), m.qos) if not m.topic.endswith(str(me)) else None
    time.sleep(2); c.connect("10.0.0.1", 1883, keepalive=5); c.loop_start(); time.sleep(0.5)
    for k in range(3): time.sleep(0.8); c.publish(f"chat/{me}", f"{k} of {me}", qos=k % 3)
    time.sleep(0.8); c.disconnect(); c.loop_stop(); print("done")
