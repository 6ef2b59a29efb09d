-- Schema 5. Only types and clauses that SQLite and PostgreSQL share.

-- The past of one arm, and of a whole fleet, without reading every run.
CREATE INDEX runs_of_arm ON runs (arm, run);
CREATE INDEX results_by_name ON results (name, run);
