from viewer.notebook import embed as embed
from viewer.plugin import attach as attach
from viewer.plugin import draw as draw
