"""Facts about the machine: processes, temporary folders, variables for programs of others, addresses."""
