"""What tests of the whole bridge share: two ROS domains, engines between them, relays that harm what crosses."""
