# paho-mqtt as a client of the broker in agent 1 (used by mosquitto.sh).
import sys, time
import paho.mqtt.client as mqtt
me = int(sys.argv[1])
c = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id=f"agent{me}", protocol=mqtt.MQTTv5)
c.will_set("gone", f"agent {me}")
c.on_connect = lambda c, u, flags, reason, properties: (print("connected", reason), c.subscribe([("chat/#", 1), ("gone", 1)]))
c.on_message = lambda c, u, m: print(m.topic, m.payload.decode(), m.qos) if not m.topic.endswith(str(me)) else None
time.sleep(1); c.connect("10.0.0.1", 1883, keepalive=3); c.loop_start(); time.sleep(0.5)
for k in range(3): time.sleep(0.8); c.publish(f"chat/{me}", f"{k} of {me}", qos=k % 3)
time.sleep(0.8); c.disconnect(); c.loop_stop(); print("done")
