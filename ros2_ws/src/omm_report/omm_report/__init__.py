"""Results as people read them: text, pictures, documents. Knows nothing of ROS."""
