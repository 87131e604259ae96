"""Every key and action of the console, and what each does."""
