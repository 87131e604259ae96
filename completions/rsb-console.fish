# Completion of rsb-console for fish.
rsb-console completion fish | source
