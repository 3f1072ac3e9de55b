"""ROS JointTrajectory: post and reader."""
