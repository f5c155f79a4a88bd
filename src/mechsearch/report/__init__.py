"""Documents that show findings: a page, a PDF, figures; remade from files alone."""
