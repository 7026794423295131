"""Gain, offset and sensitivity from points that somebody measured.

    points    a CSV file -> pairs with their lines
    line      a straight line through them, with uncertainties
    checks    what is wrong with points: units, switch, outliers, a bend
    document  results -> the text of a calibration file
"""
