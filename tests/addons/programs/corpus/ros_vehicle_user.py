# As `agent`: tells the node `vehicle` where it is, and prints what is commanded. As `user`: steers by /odom, and talks.
import json, socket, sys, threading, time
me = int(sys.argv[2])

def agent():
    s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.bind(("127.0.0.1", 14561)); known = set()
    def hear():
        while True:
            text = s.recv(9999).decode().strip()
            if text not in known: known.add(text); print(f"agent {me} is commanded", text, flush=True)
    threading.Thread(target=hear, daemon=True).start(); begin = time.monotonic()
    while True:
        told = {"t": time.monotonic() - begin, "position": [me, 2.0, 30.0], "theta": 0.0, "psi": 0.0, "velocity": [1.0, 0.0, 0.0], "q": 0.0, "r": 0.0}
        s.sendto(json.dumps(told).encode(), ("127.0.0.1", 14560)); time.sleep(0.1)

def user(kind):
    import rclpy
    from geometry_msgs.msg import Twist, TwistStamped, Wrench, WrenchStamped
    from nav_msgs.msg import Odometry
    from std_msgs.msg import String
    kinds = {"twist": Twist, "twist_stamped": TwistStamped, "wrench": Wrench, "wrench_stamped": WrenchStamped}
    rclpy.init(); node = rclpy.create_node(f"user{me}"); odoms, heard = set(), set()
    topic = "cmd_vel" if "twist" in kind else "wrench"; command = node.create_publisher(kinds[kind], topic, 10); talk = node.create_publisher(String, "talk", 10)
    def steer(odom):
        odoms.add((odom.child_frame_id, odom.pose.pose.position.y)); message = kinds[kind]()
        if "twist" in kind: twist = getattr(message, "twist", message); twist.linear.x, twist.angular.y, twist.angular.z = 1.5, 0.1, 0.01 * me
        else: wrench = getattr(message, "wrench", message); wrench.force.x, wrench.torque.y, wrench.torque.z = 7.0, 2.0, float(me)
        command.publish(message); talk.publish(String(data=f"of {me}"))
    node.create_subscription(Odometry, "odom", steer, 10); node.create_subscription(String, "talk", lambda m: heard.add(m.data), 10)
    end = time.monotonic() + 6
    while time.monotonic() < end: rclpy.spin_once(node, timeout_sec=0.1)
    print(f"user {me} knows", sorted(odoms), "and hears", sorted(heard), "nodes", sorted(node.get_node_names())); print("done")

agent() if sys.argv[1] == "agent" else user(sys.argv[3])
