"""A page to look at: one HTML file with a result in 3D, its pictures, curves, numbers and what its bundle is made of; or the same live.

    facts.py    a bundle's description -> plans, stages, limits, versions as plain values
    result.py   a session and its run -> the rest of the page's data, and the model as GLB
    html.py     data -> one file, with style.css, viewer.js and page.js inside; nothing is fetched, ever
"""
