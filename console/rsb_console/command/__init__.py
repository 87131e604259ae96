"""The command `rsb-console`: its arguments, what each subcommand does, and bridging without a console."""
