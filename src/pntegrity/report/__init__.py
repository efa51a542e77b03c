"""What a run leaves behind: tables, figures, words and one HTML file."""
