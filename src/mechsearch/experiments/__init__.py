"""`mechsearch sweep`: a plan, its jobs, their schedule and journal."""
