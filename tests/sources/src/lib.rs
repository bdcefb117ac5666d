//! Tests that read the sources and documents of the workspace and run nothing of them: they compile in seconds.
