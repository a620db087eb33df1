"""Energy-aware path planning for wheeled skid-steer robots."""
