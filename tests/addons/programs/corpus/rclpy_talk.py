# ROS 2 (rclpy, Fast DDS): two nodes with a topic, a timer and a service.
import sys, rclpy
from rclpy.node import Node
from std_msgs.msg import String
from std_srvs.srv import Trigger
me = int(sys.argv[1]); other = 3 - me; rclpy.init(); node = Node(f"agent{me}"); heard = []; k = [0]

def tick():
    k[0] += 1; pub.publish(String(data=f"{k[0]} of {me}"))
    if k[0] == 6: client.call_async(Trigger.Request()).add_done_callback(lambda f: print("service:", f.result().message))
    if k[0] == 12: rclpy.shutdown()

def hear(m):
    if m.data.endswith(str(other)): heard.append(m.data)

def answer(request, response): response.success = True; response.message = f"agent {me} is well"; return response

pub = node.create_publisher(String, "chatter", 10); node.create_subscription(String, "chatter", hear, 10)
node.create_service(Trigger, f"health{me}", answer); client = node.create_client(Trigger, f"health{other}")
node.create_timer(0.5, tick)
rclpy.spin(node)
print("heard", len(heard) >= 5, f"3 of {other}" in heard or f"6 of {other}" in heard); print("done")
