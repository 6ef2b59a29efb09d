-- Schema 6. Only types and clauses that SQLite and PostgreSQL share.

-- What an overview of all runs reads, without the pages of their plans.
CREATE INDEX runs_overview ON runs (run, created_utc, robot, arm, state);
-- No statement uses it.
DROP INDEX runs_by_arm;
