"""Session files and what belongs to them: saving, topic drafts, client files, reports, the demo session."""
