"""Where a cart is: a filter over its wheels, its gyro, and scans of its lidar held against the map."""
