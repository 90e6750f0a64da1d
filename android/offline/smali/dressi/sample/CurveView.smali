.class public final Ldressi/sample/CurveView;
.super Landroid/view/View;


# static fields
.field private static final MOST:I = 0x190


# instance fields
.field private count:I

.field private final line:Landroid/graphics/Paint;

.field private final losses:[F

.field private final words:Landroid/graphics/Paint;


# direct methods
.method public constructor <init>(Landroid/content/Context;)V
    .registers 7

    const/4 v1, 0x1

    invoke-direct {p0, p1}, Landroid/view/View;-><init>(Landroid/content/Context;)V

    const/16 v0, 0x190

    new-array v0, v0, [F

    iput-object v0, p0, Ldressi/sample/CurveView;->losses:[F

    new-instance v0, Landroid/graphics/Paint;

    invoke-direct {v0, v1}, Landroid/graphics/Paint;-><init>(I)V

    iput-object v0, p0, Ldressi/sample/CurveView;->line:Landroid/graphics/Paint;

    new-instance v0, Landroid/graphics/Paint;

    invoke-direct {v0, v1}, Landroid/graphics/Paint;-><init>(I)V

    iput-object v0, p0, Ldressi/sample/CurveView;->words:Landroid/graphics/Paint;

    invoke-virtual {p0}, Ldressi/sample/CurveView;->getResources()Landroid/content/res/Resources;

    move-result-object v0

    invoke-virtual {v0}, Landroid/content/res/Resources;->getDisplayMetrics()Landroid/util/DisplayMetrics;

    move-result-object v0

    iget v0, v0, Landroid/util/DisplayMetrics;->density:F

    iget-object v1, p0, Ldressi/sample/CurveView;->line:Landroid/graphics/Paint;

    const/16 v2, 0x1f

    const/16 v3, 0x77

    const/16 v4, 0xb4

    invoke-static {v2, v3, v4}, Landroid/graphics/Color;->rgb(III)I

    move-result v2

    invoke-virtual {v1, v2}, Landroid/graphics/Paint;->setColor(I)V

    iget-object v1, p0, Ldressi/sample/CurveView;->line:Landroid/graphics/Paint;

    const/high16 v2, 0x40000000    # 2.0f

    mul-float/2addr v2, v0

    invoke-virtual {v1, v2}, Landroid/graphics/Paint;->setStrokeWidth(F)V

    iget-object v1, p0, Ldressi/sample/CurveView;->words:Landroid/graphics/Paint;

    const v2, -0x777778

    invoke-virtual {v1, v2}, Landroid/graphics/Paint;->setColor(I)V

    iget-object v1, p0, Ldressi/sample/CurveView;->words:Landroid/graphics/Paint;

    const/high16 v2, 0x41400000    # 12.0f

    mul-float/2addr v0, v2

    invoke-virtual {v1, v0}, Landroid/graphics/Paint;->setTextSize(F)V

    return-void
.end method


# virtual methods
.method add(F)V
    .registers 6

    iget v0, p0, Ldressi/sample/CurveView;->count:I

    const/16 v1, 0x190

    if-ne v0, v1, :cond_24

    const/4 v0, 0x0

    iput v0, p0, Ldressi/sample/CurveView;->count:I

    :goto_9
    iget v0, p0, Ldressi/sample/CurveView;->count:I

    const/16 v1, 0xc8

    if-ge v0, v1, :cond_24

    iget-object v0, p0, Ldressi/sample/CurveView;->losses:[F

    iget v1, p0, Ldressi/sample/CurveView;->count:I

    iget-object v2, p0, Ldressi/sample/CurveView;->losses:[F

    iget v3, p0, Ldressi/sample/CurveView;->count:I

    mul-int/lit8 v3, v3, 0x2

    aget v2, v2, v3

    aput v2, v0, v1

    iget v0, p0, Ldressi/sample/CurveView;->count:I

    add-int/lit8 v0, v0, 0x1

    iput v0, p0, Ldressi/sample/CurveView;->count:I

    goto :goto_9

    :cond_24
    iget-object v0, p0, Ldressi/sample/CurveView;->losses:[F

    iget v1, p0, Ldressi/sample/CurveView;->count:I

    add-int/lit8 v2, v1, 0x1

    iput v2, p0, Ldressi/sample/CurveView;->count:I

    aput p1, v0, v1

    invoke-virtual {p0}, Ldressi/sample/CurveView;->invalidate()V

    return-void
.end method

.method clear()V
    .registers 2

    const/4 v0, 0x0

    iput v0, p0, Ldressi/sample/CurveView;->count:I

    invoke-virtual {p0}, Ldressi/sample/CurveView;->invalidate()V

    return-void
.end method

.method protected onDraw(Landroid/graphics/Canvas;)V
    .registers 19

    const v4, 0x7f7fffff    # Float.MAX_VALUE

    const/4 v3, 0x0

    const/4 v2, 0x0

    move v8, v3

    move v9, v4

    :goto_7
    move-object/from16 v0, p0

    iget v3, v0, Ldressi/sample/CurveView;->count:I

    if-ge v2, v3, :cond_2d

    move-object/from16 v0, p0

    iget-object v3, v0, Ldressi/sample/CurveView;->losses:[F

    aget v3, v3, v2

    const v4, 0x2b8cbccc    # 1.0E-12f

    invoke-static {v3, v4}, Ljava/lang/Math;->max(FF)F

    move-result v3

    invoke-static {v9, v3}, Ljava/lang/Math;->min(FF)F

    move-result v4

    move-object/from16 v0, p0

    iget-object v3, v0, Ldressi/sample/CurveView;->losses:[F

    aget v3, v3, v2

    invoke-static {v8, v3}, Ljava/lang/Math;->max(FF)F

    move-result v3

    add-int/lit8 v2, v2, 0x1

    move v8, v3

    move v9, v4

    goto :goto_7

    :cond_2d
    move-object/from16 v0, p0

    iget v2, v0, Ldressi/sample/CurveView;->count:I

    if-nez v2, :cond_34

    :goto_33
    return-void

    :cond_34
    float-to-double v2, v8

    const-wide v4, 0x3d719799812dea11L    # 1.0E-12

    add-double/2addr v2, v4

    invoke-static {v2, v3}, Ljava/lang/Math;->log(D)D

    move-result-wide v12

    float-to-double v2, v9

    invoke-static {v2, v3}, Ljava/lang/Math;->log(D)D

    move-result-wide v2

    sub-double v2, v12, v2

    const-wide v4, 0x3eb0c6f7a0b5ed8dL    # 1.0E-6

    invoke-static {v2, v3, v4, v5}, Ljava/lang/Math;->max(DD)D

    move-result-wide v14

    const/4 v4, 0x0

    move-object/from16 v0, p0

    iget-object v2, v0, Ldressi/sample/CurveView;->words:Landroid/graphics/Paint;

    invoke-virtual {v2}, Landroid/graphics/Paint;->getTextSize()F

    move-result v2

    const/high16 v3, 0x3fc00000    # 1.5f

    mul-float v11, v2, v3

    invoke-virtual/range {p0 .. p0}, Ldressi/sample/CurveView;->getHeight()I

    move-result v2

    int-to-float v2, v2

    const/high16 v3, 0x40000000    # 2.0f

    mul-float/2addr v3, v11

    sub-float v16, v2, v3

    const/4 v2, 0x0

    move v10, v2

    :goto_68
    move-object/from16 v0, p0

    iget v2, v0, Ldressi/sample/CurveView;->count:I

    if-ge v10, v2, :cond_b0

    move-object/from16 v0, p0

    iget-object v2, v0, Ldressi/sample/CurveView;->losses:[F

    aget v2, v2, v10

    const v3, 0x2b8cbccc    # 1.0E-12f

    invoke-static {v2, v3}, Ljava/lang/Math;->max(FF)F

    move-result v2

    float-to-double v2, v2

    invoke-static {v2, v3}, Ljava/lang/Math;->log(D)D

    move-result-wide v2

    sub-double v2, v12, v2

    div-double/2addr v2, v14

    double-to-float v2, v2

    mul-float v2, v2, v16

    add-float v6, v11, v2

    invoke-virtual/range {p0 .. p0}, Ldressi/sample/CurveView;->getWidth()I

    move-result v2

    int-to-float v2, v2

    move-object/from16 v0, p0

    iget v3, v0, Ldressi/sample/CurveView;->count:I

    add-int/lit8 v3, v3, -0x1

    const/4 v5, 0x1

    invoke-static {v3, v5}, Ljava/lang/Math;->max(II)I

    move-result v3

    int-to-float v3, v3

    div-float/2addr v2, v3

    if-lez v10, :cond_ab

    add-int/lit8 v3, v10, -0x1

    int-to-float v3, v3

    mul-float/2addr v3, v2

    int-to-float v5, v10

    mul-float/2addr v5, v2

    move-object/from16 v0, p0

    iget-object v7, v0, Ldressi/sample/CurveView;->line:Landroid/graphics/Paint;

    move-object/from16 v2, p1

    invoke-virtual/range {v2 .. v7}, Landroid/graphics/Canvas;->drawLine(FFFFLandroid/graphics/Paint;)V

    :cond_ab
    add-int/lit8 v2, v10, 0x1

    move v10, v2

    move v4, v6

    goto :goto_68

    :cond_b0
    new-instance v2, Ljava/lang/StringBuilder;

    invoke-direct {v2}, Ljava/lang/StringBuilder;-><init>()V

    const-string v3, "loss "

    invoke-virtual {v2, v3}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v2

    invoke-virtual {v2, v8}, Ljava/lang/StringBuilder;->append(F)Ljava/lang/StringBuilder;

    move-result-object v2

    invoke-virtual {v2}, Ljava/lang/StringBuilder;->toString()Ljava/lang/String;

    move-result-object v2

    const/4 v3, 0x0

    move-object/from16 v0, p0

    iget-object v4, v0, Ldressi/sample/CurveView;->words:Landroid/graphics/Paint;

    invoke-virtual {v4}, Landroid/graphics/Paint;->getTextSize()F

    move-result v4

    move-object/from16 v0, p0

    iget-object v5, v0, Ldressi/sample/CurveView;->words:Landroid/graphics/Paint;

    move-object/from16 v0, p1

    invoke-virtual {v0, v2, v3, v4, v5}, Landroid/graphics/Canvas;->drawText(Ljava/lang/String;FFLandroid/graphics/Paint;)V

    invoke-static {v9}, Ljava/lang/Float;->toString(F)Ljava/lang/String;

    move-result-object v2

    const/4 v3, 0x0

    invoke-virtual/range {p0 .. p0}, Ldressi/sample/CurveView;->getHeight()I

    move-result v4

    int-to-float v4, v4

    move-object/from16 v0, p0

    iget-object v5, v0, Ldressi/sample/CurveView;->words:Landroid/graphics/Paint;

    invoke-virtual {v5}, Landroid/graphics/Paint;->getTextSize()F

    move-result v5

    const v6, 0x3e99999a    # 0.3f

    mul-float/2addr v5, v6

    sub-float/2addr v4, v5

    move-object/from16 v0, p0

    iget-object v5, v0, Ldressi/sample/CurveView;->words:Landroid/graphics/Paint;

    move-object/from16 v0, p1

    invoke-virtual {v0, v2, v3, v4, v5}, Landroid/graphics/Canvas;->drawText(Ljava/lang/String;FFLandroid/graphics/Paint;)V

    goto/16 :goto_33
.end method
