"""The frame of a report's page: no script, and nothing is fetched."""

PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy"
  content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<title>$title</title>
<style>
:root { --ink: #20242c; --soft: #5b616b; --line: #d9dce1; --paper: #fff; --accent: #0072b2;
  --better: #00694b; --worse: #a63f00; }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 2.5rem 1.25rem 4rem; max-width: 68rem; color: var(--ink);
  background: var(--paper); font: 17px/1.55 system-ui, -apple-system, "Segoe UI", sans-serif; }
h1, h2, h3 { line-height: 1.2; text-wrap: balance; }
h1 { font-size: 2.1rem; margin: 0 0 .5rem; letter-spacing: -.015em; }
h2 { font-size: 1.4rem; margin: 3rem 0 1rem; padding-top: 1rem; border-top: 2px solid var(--ink); }
h3 { font-size: 1.05rem; margin: 1.75rem 0 .5rem; }
p, ul { max-width: 44rem; }
ul { padding-left: 1.2rem; }
li { margin: .35rem 0; }
.lead { font-size: 1.15rem; color: var(--soft); }
.verdict { font-size: 1.15rem; }
.note, figcaption, caption { color: var(--soft); font-size: .9rem; }
.wide { overflow-x: auto; margin: 1.5rem 0; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums;
  font-size: .88rem; }
caption { text-align: left; padding-bottom: .4rem; }
th, td { padding: .4rem .45rem; text-align: right; vertical-align: top;
  border-bottom: 1px solid var(--line); white-space: nowrap; }
thead th { border-bottom: 1.5px solid var(--ink); font-weight: 600; }
th:first-child { text-align: left; padding-left: 0; }
tbody th { font-weight: 600; }
.words th, .words td { text-align: left; white-space: normal; }
.words tbody th { font-weight: 400; }
.words caption { color: var(--ink); font-weight: 600; }
small { display: block; color: var(--soft); font-size: .82em; font-weight: 400; }
td.better { color: var(--better); font-weight: 600; }
td.worse { color: var(--worse); font-weight: 600; }
figure { margin: 1.25rem 0; }
img { max-width: 100%; height: auto; display: block; }
.row { display: grid; grid-template-columns: repeat(auto-fit, minmax(18rem, 1fr)); gap: 1rem; }
.row figure { margin: 0; }
.row img { border-radius: 4px; }
@media print {
  body { max-width: none; padding: 0; font-size: 10pt; }
  .row { grid-template-columns: repeat(3, 1fr); }
  .wide { overflow: visible; }
  table { font-size: 8.5pt; }
  th, td { padding: .2rem .4rem; }
  h2, h3, caption { break-after: avoid; }
  figure, tr { break-inside: avoid; }
}
</style>
</head>
<body>
<header><h1>$title</h1><p class="lead">$lead</p></header>
<main>
$body
</main>
</body>
</html>
"""
