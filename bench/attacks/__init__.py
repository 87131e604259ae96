"""What each attack does to legitimate service: ``python -m bench.attacks [NAME ...]``, some minutes for all."""
