"""Session files and what belongs to them: saving, recent files, topic drafts, exports, the demo session."""
