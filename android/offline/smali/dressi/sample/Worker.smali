.class final Ldressi/sample/Worker;
.super Ljava/lang/Thread;


# annotations
.annotation system Ldalvik/annotation/MemberClasses;
    value = {
        Ldressi/sample/Worker$Listener;
    }
.end annotation


# static fields
.field private static final CHUNK_SECONDS:D = 0.2


# instance fields
.field private final bundle:Ljava/lang/String;

.field private final context:Landroid/content/Context;

.field private final fresh:Z

.field private final listener:Ldressi/sample/Worker$Listener;

.field private volatile otherPictures:Z

.field private volatile paused:Z

.field private final stop:Ljava/util/concurrent/atomic/AtomicBoolean;


# direct methods
.method constructor <init>(Landroid/content/Context;Ljava/lang/String;ZZLdressi/sample/Worker$Listener;)V
    .registers 8

    new-instance v0, Ljava/lang/StringBuilder;

    invoke-direct {v0}, Ljava/lang/StringBuilder;-><init>()V

    const-string v1, "dressi "

    invoke-virtual {v0, v1}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v0

    invoke-virtual {v0, p2}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v0

    invoke-virtual {v0}, Ljava/lang/StringBuilder;->toString()Ljava/lang/String;

    move-result-object v0

    invoke-direct {p0, v0}, Ljava/lang/Thread;-><init>(Ljava/lang/String;)V

    new-instance v0, Ljava/util/concurrent/atomic/AtomicBoolean;

    invoke-direct {v0}, Ljava/util/concurrent/atomic/AtomicBoolean;-><init>()V

    iput-object v0, p0, Ldressi/sample/Worker;->stop:Ljava/util/concurrent/atomic/AtomicBoolean;

    invoke-virtual {p1}, Landroid/content/Context;->getApplicationContext()Landroid/content/Context;

    move-result-object v0

    iput-object v0, p0, Ldressi/sample/Worker;->context:Landroid/content/Context;

    iput-object p2, p0, Ldressi/sample/Worker;->bundle:Ljava/lang/String;

    iput-boolean p3, p0, Ldressi/sample/Worker;->fresh:Z

    iput-boolean p4, p0, Ldressi/sample/Worker;->paused:Z

    iput-object p5, p0, Ldressi/sample/Worker;->listener:Ldressi/sample/Worker$Listener;

    return-void
.end method

.method private static about(Ldressi/Session;Ldressi/Device;Ljava/lang/String;D)Ljava/lang/String;
    .registers 14

    invoke-virtual {p0}, Ldressi/Session;->report()Ljava/lang/String;

    move-result-object v1

    const-string v0, "\"profile\": \""

    invoke-virtual {v1, v0}, Ljava/lang/String;->indexOf(Ljava/lang/String;)I

    move-result v2

    invoke-virtual {v0}, Ljava/lang/String;->length()I

    move-result v0

    add-int/2addr v2, v0

    new-instance v0, Ljava/lang/StringBuilder;

    invoke-direct {v0}, Ljava/lang/StringBuilder;-><init>()V

    invoke-virtual {v0, p2}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v3

    const-wide/16 v4, 0x0

    cmpl-double v0, p3, v4

    if-lez v0, :cond_69

    sget-object v0, Ljava/util/Locale;->ROOT:Ljava/util/Locale;

    const-string v4, "\n%.1f ms a step"

    const/4 v5, 0x1

    new-array v5, v5, [Ljava/lang/Object;

    const/4 v6, 0x0

    invoke-static {p3, p4}, Ljava/lang/Double;->valueOf(D)Ljava/lang/Double;

    move-result-object v7

    aput-object v7, v5, v6

    invoke-static {v0, v4, v5}, Ljava/lang/String;->format(Ljava/util/Locale;Ljava/lang/String;[Ljava/lang/Object;)Ljava/lang/String;

    move-result-object v0

    :goto_30
    invoke-virtual {v3, v0}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v0

    const-string v3, "\n"

    invoke-virtual {v0, v3}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v0

    invoke-virtual {p1}, Ldressi/Device;->name()Ljava/lang/String;

    move-result-object v3

    invoke-virtual {v0, v3}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v0

    const-string v3, ", "

    invoke-virtual {v0, v3}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v0

    invoke-virtual {p1}, Ldressi/Device;->driver()Ljava/lang/String;

    move-result-object v3

    invoke-virtual {v0, v3}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v0

    const-string v3, "\nprofile "

    invoke-virtual {v0, v3}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v0

    const/16 v3, 0x22

    invoke-virtual {v1, v3, v2}, Ljava/lang/String;->indexOf(II)I

    move-result v3

    invoke-virtual {v1, v2, v3}, Ljava/lang/String;->substring(II)Ljava/lang/String;

    move-result-object v1

    invoke-virtual {v0, v1}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v0

    invoke-virtual {v0}, Ljava/lang/StringBuilder;->toString()Ljava/lang/String;

    move-result-object v0

    return-object v0

    :cond_69
    const-string v0, ""

    goto :goto_30
.end method

.method private static bitmap(Ldressi/Value;Ljava/nio/ByteBuffer;)Landroid/graphics/Bitmap;
    .registers 11

    const/4 v3, 0x3

    invoke-virtual {p0}, Ldressi/Value;->shape()[I

    move-result-object v0

    array-length v1, v0

    iget v2, p0, Ldressi/Value;->channels:I

    if-lt v1, v3, :cond_c

    if-ge v2, v3, :cond_e

    :cond_c
    const/4 v0, 0x0

    :goto_d
    return-object v0

    :cond_e
    add-int/lit8 v3, v1, -0x3

    aget v3, v0, v3

    add-int/lit8 v1, v1, -0x2

    aget v1, v0, v1

    mul-int v0, v1, v3

    new-array v4, v0, [I

    invoke-virtual {p1}, Ljava/nio/ByteBuffer;->asFloatBuffer()Ljava/nio/FloatBuffer;

    move-result-object v5

    const/4 v0, 0x0

    :goto_1f
    array-length v6, v4

    if-ge v0, v6, :cond_42

    mul-int v6, v0, v2

    const/high16 v7, -0x1000000

    invoke-static {v5, v6}, Ldressi/sample/Worker;->level(Ljava/nio/FloatBuffer;I)I

    move-result v8

    shl-int/lit8 v8, v8, 0x10

    or-int/2addr v7, v8

    add-int/lit8 v8, v6, 0x1

    invoke-static {v5, v8}, Ldressi/sample/Worker;->level(Ljava/nio/FloatBuffer;I)I

    move-result v8

    shl-int/lit8 v8, v8, 0x8

    or-int/2addr v7, v8

    add-int/lit8 v6, v6, 0x2

    invoke-static {v5, v6}, Ldressi/sample/Worker;->level(Ljava/nio/FloatBuffer;I)I

    move-result v6

    or-int/2addr v6, v7

    aput v6, v4, v0

    add-int/lit8 v0, v0, 0x1

    goto :goto_1f

    :cond_42
    sget-object v0, Landroid/graphics/Bitmap$Config;->ARGB_8888:Landroid/graphics/Bitmap$Config;

    invoke-static {v4, v1, v3, v0}, Landroid/graphics/Bitmap;->createBitmap([IIILandroid/graphics/Bitmap$Config;)Landroid/graphics/Bitmap;

    move-result-object v0

    goto :goto_d
.end method

.method private direct(Ljava/lang/String;)Ljava/nio/ByteBuffer;
    .registers 7
    .annotation system Ldalvik/annotation/Throws;
        value = {
            Ljava/io/IOException;
        }
    .end annotation

    iget-object v0, p0, Ldressi/sample/Worker;->context:Landroid/content/Context;

    invoke-virtual {v0}, Landroid/content/Context;->getAssets()Landroid/content/res/AssetManager;

    move-result-object v0

    const/4 v1, 0x2

    invoke-virtual {v0, p1, v1}, Landroid/content/res/AssetManager;->open(Ljava/lang/String;I)Ljava/io/InputStream;

    move-result-object v1

    :try_start_b
    new-instance v0, Ljava/io/ByteArrayOutputStream;

    invoke-virtual {v1}, Ljava/io/InputStream;->available()I

    move-result v2

    const/high16 v3, 0x10000

    invoke-static {v2, v3}, Ljava/lang/Math;->max(II)I

    move-result v2

    invoke-direct {v0, v2}, Ljava/io/ByteArrayOutputStream;-><init>(I)V

    const/high16 v2, 0x10000

    new-array v2, v2, [B

    :goto_1e
    invoke-virtual {v1, v2}, Ljava/io/InputStream;->read([B)I

    move-result v3

    if-lez v3, :cond_30

    const/4 v4, 0x0

    invoke-virtual {v0, v2, v4, v3}, Ljava/io/ByteArrayOutputStream;->write([BII)V
    :try_end_28
    .catch Ljava/lang/Throwable; {:try_start_b .. :try_end_28} :catch_29

    goto :goto_1e

    :catch_29
    move-exception v0

    if-eqz v1, :cond_2f

    :try_start_2c
    invoke-virtual {v1}, Ljava/io/InputStream;->close()V
    :try_end_2f
    .catch Ljava/lang/Throwable; {:try_start_2c .. :try_end_2f} :catch_48

    :cond_2f
    :goto_2f
    throw v0

    :cond_30
    :try_start_30
    invoke-virtual {v0}, Ljava/io/ByteArrayOutputStream;->size()I

    move-result v2

    invoke-static {v2}, Ljava/nio/ByteBuffer;->allocateDirect(I)Ljava/nio/ByteBuffer;

    move-result-object v2

    invoke-virtual {v0}, Ljava/io/ByteArrayOutputStream;->toByteArray()[B

    move-result-object v0

    invoke-virtual {v2, v0}, Ljava/nio/ByteBuffer;->put([B)Ljava/nio/ByteBuffer;

    invoke-virtual {v2}, Ljava/nio/ByteBuffer;->flip()Ljava/nio/Buffer;
    :try_end_42
    .catch Ljava/lang/Throwable; {:try_start_30 .. :try_end_42} :catch_29

    if-eqz v1, :cond_47

    invoke-virtual {v1}, Ljava/io/InputStream;->close()V

    :cond_47
    return-object v2

    :catch_48
    move-exception v1

    invoke-virtual {v0, v1}, Ljava/lang/Throwable;->addSuppressed(Ljava/lang/Throwable;)V

    goto :goto_2f
.end method

.method private static level(Ljava/nio/FloatBuffer;I)I
    .registers 4

    invoke-virtual {p0, p1}, Ljava/nio/FloatBuffer;->get(I)F

    move-result v0

    const/4 v1, 0x0

    invoke-static {v0, v1}, Ljava/lang/Math;->max(FF)F

    move-result v0

    const/high16 v1, 0x3f800000    # 1.0f

    invoke-static {v0, v1}, Ljava/lang/Math;->min(FF)F

    move-result v0

    const/high16 v1, 0x437f0000    # 255.0f

    mul-float/2addr v0, v1

    invoke-static {v0}, Ljava/lang/Math;->round(F)I

    move-result v0

    return v0
.end method

.method private photograph(Ldressi/Value;Ljava/nio/ByteBuffer;)V
    .registers 18
    .annotation system Ldalvik/annotation/Throws;
        value = {
            Ljava/io/IOException;
        }
    .end annotation

    iget-object v0, p0, Ldressi/sample/Worker;->bundle:Ljava/lang/String;

    const/4 v1, 0x0

    iget-object v2, p0, Ldressi/sample/Worker;->bundle:Ljava/lang/String;

    invoke-virtual {v2}, Ljava/lang/String;->length()I

    move-result v2

    const-string v3, ".dressi"

    invoke-virtual {v3}, Ljava/lang/String;->length()I

    move-result v3

    sub-int/2addr v2, v3

    invoke-virtual {v0, v1, v2}, Ljava/lang/String;->substring(II)Ljava/lang/String;

    move-result-object v9

    iget-object v0, p0, Ldressi/sample/Worker;->context:Landroid/content/Context;

    invoke-virtual {v0}, Landroid/content/Context;->getAssets()Landroid/content/res/AssetManager;

    move-result-object v0

    invoke-virtual {v0, v9}, Landroid/content/res/AssetManager;->list(Ljava/lang/String;)[Ljava/lang/String;

    move-result-object v10

    invoke-virtual/range {p1 .. p1}, Ldressi/Value;->shape()[I

    move-result-object v0

    if-eqz v10, :cond_2b

    array-length v1, v10

    if-eqz v1, :cond_2b

    array-length v1, v0

    const/4 v2, 0x4

    if-eq v1, v2, :cond_44

    :cond_2b
    new-instance v0, Ljava/io/IOException;

    new-instance v1, Ljava/lang/StringBuilder;

    invoke-direct {v1}, Ljava/lang/StringBuilder;-><init>()V

    const-string v2, "there are no pictures in the assets\' folder "

    invoke-virtual {v1, v2}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v1

    invoke-virtual {v1, v9}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v1

    invoke-virtual {v1}, Ljava/lang/StringBuilder;->toString()Ljava/lang/String;

    move-result-object v1

    invoke-direct {v0, v1}, Ljava/io/IOException;-><init>(Ljava/lang/String;)V

    throw v0

    :cond_44
    invoke-static {v10}, Ljava/util/Arrays;->sort([Ljava/lang/Object;)V

    const/4 v1, 0x0

    aget v11, v0, v1

    const/4 v1, 0x1

    aget v7, v0, v1

    const/4 v1, 0x2

    aget v3, v0, v1

    const/4 v1, 0x3

    aget v12, v0, v1

    mul-int v0, v3, v7

    new-array v1, v0, [I

    invoke-virtual/range {p2 .. p2}, Ljava/nio/ByteBuffer;->asFloatBuffer()Ljava/nio/FloatBuffer;

    move-result-object v13

    const/4 v0, 0x0

    move v8, v0

    :goto_5d
    if-ge v8, v11, :cond_f3

    iget-object v0, p0, Ldressi/sample/Worker;->context:Landroid/content/Context;

    invoke-virtual {v0}, Landroid/content/Context;->getAssets()Landroid/content/res/AssetManager;

    move-result-object v0

    new-instance v2, Ljava/lang/StringBuilder;

    invoke-direct {v2}, Ljava/lang/StringBuilder;-><init>()V

    invoke-virtual {v2, v9}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v2

    const-string v4, "/"

    invoke-virtual {v2, v4}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v2

    array-length v4, v10

    rem-int v4, v8, v4

    aget-object v4, v10, v4

    invoke-virtual {v2, v4}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v2

    invoke-virtual {v2}, Ljava/lang/StringBuilder;->toString()Ljava/lang/String;

    move-result-object v2

    invoke-virtual {v0, v2}, Landroid/content/res/AssetManager;->open(Ljava/lang/String;)Ljava/io/InputStream;

    move-result-object v14

    :try_start_85
    invoke-static {v14}, Landroid/graphics/BitmapFactory;->decodeStream(Ljava/io/InputStream;)Landroid/graphics/Bitmap;

    move-result-object v0

    if-nez v0, :cond_b0

    new-instance v0, Ljava/io/IOException;

    new-instance v1, Ljava/lang/StringBuilder;

    invoke-direct {v1}, Ljava/lang/StringBuilder;-><init>()V

    array-length v2, v10

    rem-int v2, v8, v2

    aget-object v2, v10, v2

    invoke-virtual {v1, v2}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v1

    const-string v2, " is no picture"

    invoke-virtual {v1, v2}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v1

    invoke-virtual {v1}, Ljava/lang/StringBuilder;->toString()Ljava/lang/String;

    move-result-object v1

    invoke-direct {v0, v1}, Ljava/io/IOException;-><init>(Ljava/lang/String;)V

    throw v0
    :try_end_a9
    .catch Ljava/lang/Throwable; {:try_start_85 .. :try_end_a9} :catch_a9

    :catch_a9
    move-exception v0

    if-eqz v14, :cond_af

    :try_start_ac
    invoke-virtual {v14}, Ljava/io/InputStream;->close()V
    :try_end_af
    .catch Ljava/lang/Throwable; {:try_start_ac .. :try_end_af} :catch_e0

    :cond_af
    :goto_af
    throw v0

    :cond_b0
    const/4 v2, 0x1

    :try_start_b1
    invoke-static {v0, v3, v7, v2}, Landroid/graphics/Bitmap;->createScaledBitmap(Landroid/graphics/Bitmap;IIZ)Landroid/graphics/Bitmap;

    move-result-object v0

    const/4 v2, 0x0

    const/4 v4, 0x0

    const/4 v5, 0x0

    move v6, v3

    invoke-virtual/range {v0 .. v7}, Landroid/graphics/Bitmap;->getPixels([IIIIIII)V
    :try_end_bc
    .catch Ljava/lang/Throwable; {:try_start_b1 .. :try_end_bc} :catch_a9

    if-eqz v14, :cond_c1

    invoke-virtual {v14}, Ljava/io/InputStream;->close()V

    :cond_c1
    array-length v5, v1

    const/4 v0, 0x0

    move v4, v0

    :goto_c4
    if-ge v4, v5, :cond_ee

    aget v6, v1, v4

    const/4 v0, 0x0

    move v2, v0

    :goto_ca
    if-ge v2, v12, :cond_ea

    const/4 v0, 0x3

    if-ne v2, v0, :cond_e5

    const/16 v0, 0x18

    :goto_d1
    ushr-int v0, v6, v0

    and-int/lit16 v0, v0, 0xff

    int-to-float v0, v0

    const/high16 v14, 0x437f0000    # 255.0f

    div-float/2addr v0, v14

    invoke-virtual {v13, v0}, Ljava/nio/FloatBuffer;->put(F)Ljava/nio/FloatBuffer;

    add-int/lit8 v0, v2, 0x1

    move v2, v0

    goto :goto_ca

    :catch_e0
    move-exception v1

    invoke-virtual {v0, v1}, Ljava/lang/Throwable;->addSuppressed(Ljava/lang/Throwable;)V

    goto :goto_af

    :cond_e5
    mul-int/lit8 v0, v2, 0x8

    rsub-int/lit8 v0, v0, 0x10

    goto :goto_d1

    :cond_ea
    add-int/lit8 v0, v4, 0x1

    move v4, v0

    goto :goto_c4

    :cond_ee
    add-int/lit8 v0, v8, 0x1

    move v8, v0

    goto/16 :goto_5d

    :cond_f3
    return-void
.end method

.method private rest()V
    .registers 3

    const-wide/16 v0, 0x32

    :try_start_2
    invoke-static {v0, v1}, Ljava/lang/Thread;->sleep(J)V
    :try_end_5
    .catch Ljava/lang/InterruptedException; {:try_start_2 .. :try_end_5} :catch_6

    :goto_5
    return-void

    :catch_6
    move-exception v0

    iget-object v0, p0, Ldressi/sample/Worker;->stop:Ljava/util/concurrent/atomic/AtomicBoolean;

    const/4 v1, 0x1

    invoke-virtual {v0, v1}, Ljava/util/concurrent/atomic/AtomicBoolean;->set(Z)V

    goto :goto_5
.end method

.method private static restore(Ldressi/Session;Ljava/io/File;)V
    .registers 5

    :try_start_0
    invoke-virtual {p1}, Ljava/io/File;->getPath()Ljava/lang/String;

    move-result-object v0

    invoke-virtual {p0, v0}, Ldressi/Session;->restore(Ljava/lang/String;)V
    :try_end_7
    .catch Ldressi/DressiException; {:try_start_0 .. :try_end_7} :catch_8

    :cond_7
    return-void

    :catch_8
    move-exception v0

    iget v1, v0, Ldressi/DressiException;->code:I

    const/4 v2, 0x2

    if-ne v1, v2, :cond_14

    invoke-virtual {p1}, Ljava/io/File;->delete()Z

    move-result v1

    if-nez v1, :cond_7

    :cond_14
    throw v0
.end method

.method private static runs(Ldressi/Session;Ljava/lang/String;)J
    .registers 6

    invoke-virtual {p0}, Ldressi/Session;->report()Ljava/lang/String;

    move-result-object v2

    new-instance v0, Ljava/lang/StringBuilder;

    invoke-direct {v0}, Ljava/lang/StringBuilder;-><init>()V

    const-string v1, "\""

    invoke-virtual {v0, v1}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v0

    invoke-virtual {v0, p1}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v0

    const-string v1, "\": "

    invoke-virtual {v0, v1}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v0

    invoke-virtual {v0}, Ljava/lang/StringBuilder;->toString()Ljava/lang/String;

    move-result-object v0

    const-string v1, "\"runs\": "

    invoke-virtual {v2, v1}, Ljava/lang/String;->indexOf(Ljava/lang/String;)I

    move-result v1

    invoke-virtual {v2, v0, v1}, Ljava/lang/String;->indexOf(Ljava/lang/String;I)I

    move-result v1

    invoke-virtual {v0}, Ljava/lang/String;->length()I

    move-result v0

    add-int/2addr v1, v0

    move v0, v1

    :goto_2d
    invoke-virtual {v2}, Ljava/lang/String;->length()I

    move-result v3

    if-ge v0, v3, :cond_40

    invoke-virtual {v2, v0}, Ljava/lang/String;->charAt(I)C

    move-result v3

    invoke-static {v3}, Ljava/lang/Character;->isDigit(C)Z

    move-result v3

    if-eqz v3, :cond_40

    add-int/lit8 v0, v0, 0x1

    goto :goto_2d

    :cond_40
    if-ne v0, v1, :cond_45

    const-wide/16 v0, 0x0

    :goto_44
    return-wide v0

    :cond_45
    invoke-virtual {v2, v1, v0}, Ljava/lang/String;->substring(II)Ljava/lang/String;

    move-result-object v0

    invoke-static {v0}, Ljava/lang/Long;->parseLong(Ljava/lang/String;)J

    move-result-wide v0

    goto :goto_44
.end method

.method private say(Ljava/lang/String;)V
    .registers 8

    const/4 v2, 0x0

    iget-object v0, p0, Ldressi/sample/Worker;->listener:Ldressi/sample/Worker$Listener;

    const/high16 v4, 0x7fc00000    # Float.NaN

    new-instance v1, Ljava/lang/StringBuilder;

    invoke-direct {v1}, Ljava/lang/StringBuilder;-><init>()V

    iget-object v3, p0, Ldressi/sample/Worker;->bundle:Ljava/lang/String;

    invoke-virtual {v1, v3}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v1

    const-string v3, ": "

    invoke-virtual {v1, v3}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v1

    invoke-virtual {v1, p1}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v1

    invoke-virtual {v1}, Ljava/lang/StringBuilder;->toString()Ljava/lang/String;

    move-result-object v5

    move-object v1, p0

    move-object v3, v2

    invoke-interface/range {v0 .. v5}, Ldressi/sample/Worker$Listener;->onProgress(Ldressi/sample/Worker;Landroid/graphics/Bitmap;Landroid/graphics/Bitmap;FLjava/lang/String;)V

    return-void
.end method

.method private solve(Ldressi/Session;Ldressi/Device;Ldressi/Value;Ljava/nio/ByteBuffer;Ldressi/Value;Ljava/nio/ByteBuffer;)V
    .registers 31
    .annotation system Ldalvik/annotation/Throws;
        value = {
            Ljava/io/IOException;
        }
    .end annotation

    invoke-virtual/range {p1 .. p1}, Ldressi/Session;->phases()Ljava/util/List;

    move-result-object v4

    invoke-interface {v4}, Ljava/util/List;->iterator()Ljava/util/Iterator;

    move-result-object v16

    :cond_8
    invoke-interface/range {v16 .. v16}, Ljava/util/Iterator;->hasNext()Z

    move-result v4

    if-eqz v4, :cond_107

    invoke-interface/range {v16 .. v16}, Ljava/util/Iterator;->next()Ljava/lang/Object;

    move-result-object v7

    check-cast v7, Ljava/lang/String;

    move-object/from16 v0, p1

    invoke-virtual {v0, v7}, Ldressi/Session;->steps(Ljava/lang/String;)J

    move-result-wide v18

    move-object/from16 v0, p1

    invoke-static {v0, v7}, Ldressi/sample/Worker;->runs(Ldressi/Session;Ljava/lang/String;)J

    move-result-wide v4

    sub-long v4, v18, v4

    const-wide/16 v8, 0x0

    invoke-static {v4, v5, v8, v9}, Ljava/lang/Math;->max(JJ)J

    move-result-wide v5

    new-instance v4, Ljava/lang/StringBuilder;

    invoke-direct {v4}, Ljava/lang/StringBuilder;-><init>()V

    invoke-virtual {v4, v7}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v4

    const-string v8, ".loss"

    invoke-virtual {v4, v8}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v4

    invoke-virtual {v4}, Ljava/lang/StringBuilder;->toString()Ljava/lang/String;

    move-result-object v4

    move-object/from16 v0, p1

    invoke-virtual {v0, v4}, Ldressi/Session;->find(Ljava/lang/String;)Ldressi/Value;

    move-result-object v4

    if-eqz v4, :cond_84

    const/4 v4, 0x1

    move v14, v4

    :goto_45
    move-object/from16 v0, p0

    iget-object v4, v0, Ldressi/sample/Worker;->stop:Ljava/util/concurrent/atomic/AtomicBoolean;

    invoke-virtual {v4}, Ljava/util/concurrent/atomic/AtomicBoolean;->get()Z

    move-result v4

    if-nez v4, :cond_8

    const-wide/16 v8, 0x0

    cmp-long v4, v5, v8

    if-lez v4, :cond_8

    const/4 v4, 0x0

    move-object/from16 v0, p0

    iget-boolean v8, v0, Ldressi/sample/Worker;->otherPictures:Z

    if-eqz v8, :cond_108

    if-eqz p4, :cond_108

    const/4 v4, 0x0

    move-object/from16 v0, p0

    iput-boolean v4, v0, Ldressi/sample/Worker;->otherPictures:Z

    move-object/from16 v0, p0

    move-object/from16 v1, p3

    move-object/from16 v2, p4

    invoke-direct {v0, v1, v2}, Ldressi/sample/Worker;->photograph(Ldressi/Value;Ljava/nio/ByteBuffer;)V

    const-string v4, "targets"

    move-object/from16 v0, p1

    move-object/from16 v1, p4

    invoke-virtual {v0, v4, v1}, Ldressi/Session;->set(Ljava/lang/String;Ljava/nio/ByteBuffer;)V

    invoke-static/range {p3 .. p4}, Ldressi/sample/Worker;->bitmap(Ldressi/Value;Ljava/nio/ByteBuffer;)Landroid/graphics/Bitmap;

    move-result-object v4

    move-object v15, v4

    :goto_7a
    move-object/from16 v0, p0

    iget-boolean v4, v0, Ldressi/sample/Worker;->paused:Z

    if-eqz v4, :cond_87

    invoke-direct/range {p0 .. p0}, Ldressi/sample/Worker;->rest()V

    goto :goto_45

    :cond_84
    const/4 v4, 0x0

    move v14, v4

    goto :goto_45

    :cond_87
    invoke-static {}, Ljava/lang/System;->nanoTime()J

    move-result-wide v12

    const-wide v8, 0x3fc999999999999aL    # 0.2

    move-object/from16 v0, p0

    iget-object v10, v0, Ldressi/sample/Worker;->stop:Ljava/util/concurrent/atomic/AtomicBoolean;

    move-object/from16 v4, p1

    invoke-virtual/range {v4 .. v10}, Ldressi/Session;->step(JLjava/lang/String;DLjava/util/concurrent/atomic/AtomicBoolean;)J

    move-result-wide v8

    invoke-static {}, Ljava/lang/System;->nanoTime()J

    move-result-wide v10

    sub-long/2addr v10, v12

    long-to-double v10, v10

    const-wide v12, 0x3eb0c6f7a0b5ed8dL    # 1.0E-6

    mul-double/2addr v10, v12

    const-wide/16 v12, 0x1

    invoke-static {v8, v9, v12, v13}, Ljava/lang/Math;->max(JJ)J

    move-result-wide v12

    long-to-double v12, v12

    div-double v20, v10, v12

    sub-long/2addr v5, v8

    if-eqz p6, :cond_bb

    const-string v4, "render.color"

    move-object/from16 v0, p1

    move-object/from16 v1, p6

    invoke-virtual {v0, v4, v1}, Ldressi/Session;->get(Ljava/lang/String;Ljava/nio/ByteBuffer;)V

    :cond_bb
    if-eqz v14, :cond_ff

    invoke-virtual/range {p1 .. p1}, Ldressi/Session;->loss()F

    move-result v12

    :goto_c1
    sget-object v4, Ljava/util/Locale;->ROOT:Ljava/util/Locale;

    const-string v8, "%s: %d of %d steps, loss %.5g"

    const/4 v9, 0x4

    new-array v9, v9, [Ljava/lang/Object;

    const/4 v10, 0x0

    aput-object v7, v9, v10

    const/4 v10, 0x1

    sub-long v22, v18, v5

    invoke-static/range {v22 .. v23}, Ljava/lang/Long;->valueOf(J)Ljava/lang/Long;

    move-result-object v11

    aput-object v11, v9, v10

    const/4 v10, 0x2

    invoke-static/range {v18 .. v19}, Ljava/lang/Long;->valueOf(J)Ljava/lang/Long;

    move-result-object v11

    aput-object v11, v9, v10

    const/4 v10, 0x3

    invoke-static {v12}, Ljava/lang/Float;->valueOf(F)Ljava/lang/Float;

    move-result-object v11

    aput-object v11, v9, v10

    invoke-static {v4, v8, v9}, Ljava/lang/String;->format(Ljava/util/Locale;Ljava/lang/String;[Ljava/lang/Object;)Ljava/lang/String;

    move-result-object v4

    move-object/from16 v0, p0

    iget-object v8, v0, Ldressi/sample/Worker;->listener:Ldressi/sample/Worker$Listener;

    if-nez p6, :cond_102

    const/4 v11, 0x0

    :goto_ed
    move-object/from16 v0, p1

    move-object/from16 v1, p2

    move-wide/from16 v2, v20

    invoke-static {v0, v1, v4, v2, v3}, Ldressi/sample/Worker;->about(Ldressi/Session;Ldressi/Device;Ljava/lang/String;D)Ljava/lang/String;

    move-result-object v13

    move-object/from16 v9, p0

    move-object v10, v15

    invoke-interface/range {v8 .. v13}, Ldressi/sample/Worker$Listener;->onProgress(Ldressi/sample/Worker;Landroid/graphics/Bitmap;Landroid/graphics/Bitmap;FLjava/lang/String;)V

    goto/16 :goto_45

    :cond_ff
    const/high16 v12, 0x7fc00000    # Float.NaN

    goto :goto_c1

    :cond_102
    invoke-static/range {p5 .. p6}, Ldressi/sample/Worker;->bitmap(Ldressi/Value;Ljava/nio/ByteBuffer;)Landroid/graphics/Bitmap;

    move-result-object v11

    goto :goto_ed

    :cond_107
    return-void

    :cond_108
    move-object v15, v4

    goto/16 :goto_7a
.end method

.method private work()V
    .registers 19
    .annotation system Ldalvik/annotation/Throws;
        value = {
            Ljava/io/IOException;
        }
    .end annotation

    const-string v2, "opening"

    move-object/from16 v0, p0

    invoke-direct {v0, v2}, Ldressi/sample/Worker;->say(Ljava/lang/String;)V

    new-instance v10, Ljava/io/File;

    move-object/from16 v0, p0

    iget-object v2, v0, Ldressi/sample/Worker;->context:Landroid/content/Context;

    invoke-virtual {v2}, Landroid/content/Context;->getFilesDir()Ljava/io/File;

    move-result-object v2

    new-instance v3, Ljava/lang/StringBuilder;

    invoke-direct {v3}, Ljava/lang/StringBuilder;-><init>()V

    move-object/from16 v0, p0

    iget-object v4, v0, Ldressi/sample/Worker;->bundle:Ljava/lang/String;

    invoke-virtual {v3, v4}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v3

    const-string v4, ".checkpoint"

    invoke-virtual {v3, v4}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v3

    invoke-virtual {v3}, Ljava/lang/StringBuilder;->toString()Ljava/lang/String;

    move-result-object v3

    invoke-direct {v10, v2, v3}, Ljava/io/File;-><init>(Ljava/io/File;Ljava/lang/String;)V

    new-instance v2, Ljava/io/File;

    move-object/from16 v0, p0

    iget-object v3, v0, Ldressi/sample/Worker;->context:Landroid/content/Context;

    invoke-virtual {v3}, Landroid/content/Context;->getCodeCacheDir()Ljava/io/File;

    move-result-object v3

    const-string v4, "dressi"

    invoke-direct {v2, v3, v4}, Ljava/io/File;-><init>(Ljava/io/File;Ljava/lang/String;)V

    invoke-virtual {v2}, Ljava/io/File;->getPath()Ljava/lang/String;

    move-result-object v2

    new-instance v11, Ldressi/Device;

    const/4 v3, 0x0

    invoke-direct {v11, v3}, Ldressi/Device;-><init>(Ljava/lang/String;)V

    :try_start_44
    move-object/from16 v0, p0

    iget-object v3, v0, Ldressi/sample/Worker;->bundle:Ljava/lang/String;

    move-object/from16 v0, p0

    invoke-direct {v0, v3}, Ldressi/sample/Worker;->direct(Ljava/lang/String;)Ljava/nio/ByteBuffer;

    move-result-object v3

    const/4 v4, 0x0

    const/4 v5, 0x0

    invoke-static {v3, v11, v4, v2, v5}, Ldressi/Session;->open(Ljava/nio/ByteBuffer;Ldressi/Device;Ljava/lang/String;Ljava/lang/String;Ljava/lang/String;)Ldressi/Session;
    :try_end_53
    .catch Ljava/lang/Throwable; {:try_start_44 .. :try_end_53} :catch_c7

    move-result-object v12

    :try_start_54
    move-object/from16 v0, p0

    iget-boolean v2, v0, Ldressi/sample/Worker;->fresh:Z

    if-nez v2, :cond_63

    invoke-virtual {v10}, Ljava/io/File;->exists()Z

    move-result v2

    if-eqz v2, :cond_63

    invoke-static {v12, v10}, Ldressi/sample/Worker;->restore(Ldressi/Session;Ljava/io/File;)V

    :cond_63
    const-string v2, "targets"

    invoke-virtual {v12, v2}, Ldressi/Session;->find(Ljava/lang/String;)Ldressi/Value;

    move-result-object v13

    const-string v2, "render.color"

    invoke-virtual {v12, v2}, Ldressi/Session;->find(Ljava/lang/String;)Ldressi/Value;

    move-result-object v14

    if-nez v13, :cond_b0

    const/4 v2, 0x0

    move-object v9, v2

    :goto_73
    if-nez v14, :cond_b6

    const/4 v8, 0x0

    :goto_76
    if-eqz v9, :cond_7d

    const-string v2, "targets"

    invoke-virtual {v12, v2, v9}, Ldressi/Session;->get(Ljava/lang/String;Ljava/nio/ByteBuffer;)V

    :cond_7d
    if-nez v9, :cond_bb

    const/4 v4, 0x0

    :goto_80
    move-object/from16 v0, p0

    iget-object v2, v0, Ldressi/sample/Worker;->listener:Ldressi/sample/Worker$Listener;

    const/4 v5, 0x0

    const/high16 v6, 0x7fc00000    # Float.NaN

    const-string v3, ""

    const-wide/16 v16, 0x0

    move-wide/from16 v0, v16

    invoke-static {v12, v11, v3, v0, v1}, Ldressi/sample/Worker;->about(Ldressi/Session;Ldressi/Device;Ljava/lang/String;D)Ljava/lang/String;

    move-result-object v7

    move-object/from16 v3, p0

    invoke-interface/range {v2 .. v7}, Ldressi/sample/Worker$Listener;->onProgress(Ldressi/sample/Worker;Landroid/graphics/Bitmap;Landroid/graphics/Bitmap;FLjava/lang/String;)V

    move-object/from16 v2, p0

    move-object v3, v12

    move-object v4, v11

    move-object v5, v13

    move-object v6, v9

    move-object v7, v14

    invoke-direct/range {v2 .. v8}, Ldressi/sample/Worker;->solve(Ldressi/Session;Ldressi/Device;Ldressi/Value;Ljava/nio/ByteBuffer;Ldressi/Value;Ljava/nio/ByteBuffer;)V

    invoke-virtual {v10}, Ljava/io/File;->getPath()Ljava/lang/String;

    move-result-object v2

    invoke-virtual {v12, v2}, Ldressi/Session;->checkpoint(Ljava/lang/String;)V
    :try_end_a7
    .catch Ljava/lang/Throwable; {:try_start_54 .. :try_end_a7} :catch_c0

    if-eqz v12, :cond_ac

    :try_start_a9
    invoke-virtual {v12}, Ldressi/Session;->close()V
    :try_end_ac
    .catch Ljava/lang/Throwable; {:try_start_a9 .. :try_end_ac} :catch_c7

    :cond_ac
    invoke-virtual {v11}, Ldressi/Device;->close()V

    return-void

    :cond_b0
    :try_start_b0
    invoke-virtual {v13}, Ldressi/Value;->buffer()Ljava/nio/ByteBuffer;

    move-result-object v2

    move-object v9, v2

    goto :goto_73

    :cond_b6
    invoke-virtual {v14}, Ldressi/Value;->buffer()Ljava/nio/ByteBuffer;

    move-result-object v8

    goto :goto_76

    :cond_bb
    invoke-static {v13, v9}, Ldressi/sample/Worker;->bitmap(Ldressi/Value;Ljava/nio/ByteBuffer;)Landroid/graphics/Bitmap;
    :try_end_be
    .catch Ljava/lang/Throwable; {:try_start_b0 .. :try_end_be} :catch_c0

    move-result-object v4

    goto :goto_80

    :catch_c0
    move-exception v2

    if-eqz v12, :cond_c6

    :try_start_c3
    invoke-virtual {v12}, Ldressi/Session;->close()V
    :try_end_c6
    .catch Ljava/lang/Throwable; {:try_start_c3 .. :try_end_c6} :catch_cc

    :cond_c6
    :goto_c6
    :try_start_c6
    throw v2
    :try_end_c7
    .catch Ljava/lang/Throwable; {:try_start_c6 .. :try_end_c7} :catch_c7

    :catch_c7
    move-exception v2

    :try_start_c8
    invoke-virtual {v11}, Ldressi/Device;->close()V
    :try_end_cb
    .catch Ljava/lang/Throwable; {:try_start_c8 .. :try_end_cb} :catch_d1

    :goto_cb
    throw v2

    :catch_cc
    move-exception v3

    :try_start_cd
    invoke-virtual {v2, v3}, Ljava/lang/Throwable;->addSuppressed(Ljava/lang/Throwable;)V
    :try_end_d0
    .catch Ljava/lang/Throwable; {:try_start_cd .. :try_end_d0} :catch_c7

    goto :goto_c6

    :catch_d1
    move-exception v3

    invoke-virtual {v2, v3}, Ljava/lang/Throwable;->addSuppressed(Ljava/lang/Throwable;)V

    goto :goto_cb
.end method


# virtual methods
.method finish()V
    .registers 4

    const/4 v1, 0x1

    iget-object v0, p0, Ldressi/sample/Worker;->stop:Ljava/util/concurrent/atomic/AtomicBoolean;

    invoke-virtual {v0, v1}, Ljava/util/concurrent/atomic/AtomicBoolean;->set(Z)V

    const/4 v0, 0x0

    :goto_7
    invoke-virtual {p0}, Ldressi/sample/Worker;->isAlive()Z

    move-result v2

    if-eqz v2, :cond_14

    :try_start_d
    invoke-virtual {p0}, Ldressi/sample/Worker;->join()V
    :try_end_10
    .catch Ljava/lang/InterruptedException; {:try_start_d .. :try_end_10} :catch_11

    goto :goto_7

    :catch_11
    move-exception v0

    move v0, v1

    goto :goto_7

    :cond_14
    if-eqz v0, :cond_1d

    invoke-static {}, Ljava/lang/Thread;->currentThread()Ljava/lang/Thread;

    move-result-object v0

    invoke-virtual {v0}, Ljava/lang/Thread;->interrupt()V

    :cond_1d
    return-void
.end method

.method otherPictures()V
    .registers 2

    const/4 v0, 0x1

    iput-boolean v0, p0, Ldressi/sample/Worker;->otherPictures:Z

    return-void
.end method

.method pause(Z)V
    .registers 2

    iput-boolean p1, p0, Ldressi/sample/Worker;->paused:Z

    return-void
.end method

.method public run()V
    .registers 7

    const/4 v2, 0x0

    :try_start_1
    invoke-direct {p0}, Ldressi/sample/Worker;->work()V
    :try_end_4
    .catch Ldressi/DressiException; {:try_start_1 .. :try_end_4} :catch_5
    .catch Ljava/io/IOException; {:try_start_1 .. :try_end_4} :catch_2e

    :goto_4
    return-void

    :catch_5
    move-exception v0

    move-object v1, v0

    :goto_7
    iget-object v0, p0, Ldressi/sample/Worker;->listener:Ldressi/sample/Worker$Listener;

    const/high16 v4, 0x7fc00000    # Float.NaN

    new-instance v3, Ljava/lang/StringBuilder;

    invoke-direct {v3}, Ljava/lang/StringBuilder;-><init>()V

    iget-object v5, p0, Ldressi/sample/Worker;->bundle:Ljava/lang/String;

    invoke-virtual {v3, v5}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v3

    const-string v5, ": "

    invoke-virtual {v3, v5}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v3

    invoke-virtual {v1}, Ljava/lang/Exception;->getMessage()Ljava/lang/String;

    move-result-object v1

    invoke-virtual {v3, v1}, Ljava/lang/StringBuilder;->append(Ljava/lang/String;)Ljava/lang/StringBuilder;

    move-result-object v1

    invoke-virtual {v1}, Ljava/lang/StringBuilder;->toString()Ljava/lang/String;

    move-result-object v5

    move-object v1, p0

    move-object v3, v2

    invoke-interface/range {v0 .. v5}, Ldressi/sample/Worker$Listener;->onProgress(Ldressi/sample/Worker;Landroid/graphics/Bitmap;Landroid/graphics/Bitmap;FLjava/lang/String;)V

    goto :goto_4

    :catch_2e
    move-exception v0

    move-object v1, v0

    goto :goto_7
.end method
