"""What an operator can do, and with which keys."""
