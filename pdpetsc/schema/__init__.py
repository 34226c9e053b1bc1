"""What a case file may hold, and how mistakes in it are put into words."""
