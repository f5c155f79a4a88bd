"""What a robot's computer carries: an exported policy, its controller, and limits that hold."""
