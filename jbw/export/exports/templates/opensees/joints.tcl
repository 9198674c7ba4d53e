{{ about | commented("# ") }}
# For a model of -ndm 3 -ndf 6 with constraints Lagrange or Penalty. Each joint is a material between
# a held node and one whose displacement 1 is the joint's motion; mass and damping are the model's.
# Change the numbers of nodes, materials and elements where the model has them.
node {{ joints[0].nodes.ground }} 0.0 0.0 0.0
fix {{ joints[0].nodes.ground }} 1 1 1 1 1 1
{% for joint in joints %}
{% if joint.notes %}
{{ joint.notes | commented("# ") }}
{% endif %}
# {{ joint.nodes.card.name }}
node {{ joint.nodes.node }} 0.0 0.0 0.0
fix {{ joint.nodes.node }} 0 1 1 1 1 1
equationConstraint {{ joint.nodes.node }} 1 1.0 {% for node, direction, weight in joint.nodes.terms %}{{ node }} {{ direction }} {{ (-weight) | number }}{{ " " if not loop.last }}{% endfor %}

{% for line in joint.materials %}
{{ line }}
{% endfor %}
element zeroLength {{ joint.nodes.node }} {{ joint.nodes.ground }} {{ joint.nodes.node }} -mat {{ joint.nodes.node }} -dir 1
{% endfor %}
