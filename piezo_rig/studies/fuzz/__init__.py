"""Hostile files: whatever a file holds, the program reads it correctly or says one clear error.

Never a traceback, never more than 5 s or 500 MB for a file under 1 MB, and nothing in a file is
run. `make study-fuzz` throws a hundred thousand inputs at every reader, guided by the lines that
they reach; what broke is kept in tests.

    formats     what is read, by whom, and good files to begin with
    hostile_h5  run files that a format allows and no run should be
    mutate      ways to spoil a file
    reached     which lines an input reached
    campaign    one worker: spoil, read, judge, keep what is new
"""
