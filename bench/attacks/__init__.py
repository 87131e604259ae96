"""Effects of attacks on legitimate service: ``python -m bench.attacks [NAME ...]``, some minutes for all."""
