# ROS 2 (rclpy): an action server with as many threads as processors, and a client that cancels its second goal.
import sys, time, rclpy
from rclpy.action import ActionClient, ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from test_msgs.action import Fibonacci
me = int(sys.argv[1]); rclpy.init(); node = rclpy.create_node(f"agent{me}")

def execute(goal):
    feedback = Fibonacci.Feedback(sequence=[0, 1])
    for _ in range(goal.request.order):
        if goal.is_cancel_requested: goal.canceled(); print("canceled", flush=True); return Fibonacci.Result(sequence=feedback.sequence)
        feedback.sequence = [*feedback.sequence, feedback.sequence[-1] + feedback.sequence[-2]]; goal.publish_feedback(feedback); time.sleep(0.5)
    goal.succeed(); return Fibonacci.Result(sequence=feedback.sequence)

def done(future, what):
    rclpy.spin_until_future_complete(node, future); print(what, flush=True); return future.result()

if me == 1:
    server = ActionServer(node, Fibonacci, "fibonacci", execute, callback_group=ReentrantCallbackGroup(), cancel_callback=lambda _: CancelResponse.ACCEPT)
    executor = MultiThreadedExecutor(); executor.add_node(node); end = time.monotonic() + 10
    while time.monotonic() < end: executor.spin_once(timeout_sec=0.1)
    print("server done"); sys.exit()
client, heard = ActionClient(node, Fibonacci, "fibonacci"), []
client.wait_for_server(); time.sleep(0.5)
goal = done(client.send_goal_async(Fibonacci.Goal(order=4), feedback_callback=lambda m: heard.append(len(m.feedback.sequence))), "accepted")
print("result", [*done(goal.get_result_async(), "finished").result.sequence], "feedback", heard)
goal = done(client.send_goal_async(Fibonacci.Goal(order=20)), "accepted"); end = time.monotonic() + 1.2
while time.monotonic() < end: rclpy.spin_once(node, timeout_sec=0.1)
print("canceling", len(done(goal.cancel_goal_async(), "asked").goals_canceling)); print("status", done(goal.get_result_async(), "ended").status); print("client done")
