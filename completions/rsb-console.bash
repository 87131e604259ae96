# Completion of rsb-console for bash, loaded on the first TAB.
eval "$(rsb-console completion bash)"
