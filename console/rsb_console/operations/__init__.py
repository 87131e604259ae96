"""The actions that change the bridge or its session, as the operator goes through them."""
