"""What runs and evaluations say: scores, comparisons, claims, tables. Nothing is drawn here."""
