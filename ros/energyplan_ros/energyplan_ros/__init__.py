"""Nav2 planning actions answered by energyplan."""
