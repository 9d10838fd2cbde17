from viewer import attach as attach
from viewer import draw as draw
from viewer import embed as embed
