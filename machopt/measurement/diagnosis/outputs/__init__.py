"""What becomes of a diagnosis: its file, the stiffness and kinematics it leaves, and what that changes in a job."""
