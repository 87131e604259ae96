"""One topic over one link: its life, its messages, its ledger."""
