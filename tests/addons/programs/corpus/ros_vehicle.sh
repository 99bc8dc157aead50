#!/bin/sh
# The node `vehicle` beside a user's node that steers by it; ros_vehicle_user.py stands for the agent, too.
here=$(dirname "$0")
"$PYTHON" "$here/../../../../fleet/addons/programs/ros_vehicle.py" "$1" &
"$PYTHON" "$here/ros_vehicle_user.py" agent "$1" &
exec "$PYTHON" "$here/ros_vehicle_user.py" user "$1" "$2"
