"""What the screen shows and allows, from what was heard: no ROS, no network, no own clock."""
