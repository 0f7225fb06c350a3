"""Pages that stand alone: their frame, tables and line charts, as templates whose every value is escaped."""
