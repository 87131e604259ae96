"""Routes of calls: services, actions and nodes' parameters over one link."""
